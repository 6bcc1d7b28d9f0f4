"""The live page: a flight in a browser, what the pilot thinks, and a person who speaks to it."""
