"""Teaching a trained pilot a user's own pictures, words and facts, in minutes."""
