"""What a sentence asks for, and the scene that it is flown in."""
