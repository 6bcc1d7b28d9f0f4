"""What is read, corrected and judged before a vehicle is armed."""
