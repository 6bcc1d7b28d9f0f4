"""What a run's results are and mean: their files, the scores by each rule, comparisons and published numbers."""
