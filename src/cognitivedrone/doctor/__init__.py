"""Examines a policy: asks it about views whose right commands are known, and says what is wrong."""
