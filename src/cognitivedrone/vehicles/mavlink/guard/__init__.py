"""The guard: a process of its own that alone owns the link, the modes and the rules of safety.

`drone.py` is what the pilot process holds; it starts `process.py` by `python -m`. `messages.py` is what goes between.
"""
