"""Networks and their self-describing files. They know nothing of tasks, environments or episodes."""
