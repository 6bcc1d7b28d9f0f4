"""What understanding is trained with: problems in words, questions, and the corpus of sentences."""
