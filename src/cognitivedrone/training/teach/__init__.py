"""Teaching a trained pilot a user's own pictures and words."""
