"""Films of flights: first-person and chase view, map, directive, command and outcome; and their pages."""
