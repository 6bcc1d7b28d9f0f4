"""Audits: a pilot is flown again with one thing changed, to see why it passes a benchmark.

`catalogue.AUDITS` lists them, `scenes` changes tasks, `filters` what a pilot sees, `run` flies them, `report` shows the
result.
"""
