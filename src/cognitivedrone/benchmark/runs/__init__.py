"""Flying a run: the plan resolved, its workers and episodes, the folder of records, shards and sweeps."""
