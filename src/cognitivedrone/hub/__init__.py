"""Models and data sets on the Hugging Face Hub: what may go there and come from there, and both ways."""
