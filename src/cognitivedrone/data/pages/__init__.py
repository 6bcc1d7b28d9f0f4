"""What a data set shows of itself: its card, its pages."""
