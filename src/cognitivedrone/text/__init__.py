"""Text as it is read, shown and put on pages."""
