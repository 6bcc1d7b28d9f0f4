"""What is asked: families, vocabulary, facts, suites and task files. Pure data, no pixels."""
