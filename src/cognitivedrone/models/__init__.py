"""Networks and their self-describing files. Independent of tasks, environments and episodes."""
