"""The guard: a process of its own that alone owns the link, the modes and the rules of safety.

`drone.py` is what the pilot process holds, `process.py` what the guard runs (`python -m` this package), `messages.py`
what goes between the two.
"""
