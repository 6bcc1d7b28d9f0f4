"""Audits: a pilot is flown again with one thing changed, to see why it passes a benchmark.

`catalogue` lists them and changes what a pilot sees, `scenes` changes tasks, `run` flies them and shows the result.
"""
