"""The files of the Open Clip Art Library that show our concepts, picked by name and looked at."""

FILES: dict[str, str] = {}
