"""Fine-tuning of OpenVLA-7B."""
