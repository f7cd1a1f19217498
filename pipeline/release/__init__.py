"""The cards of datasets and policies, their side files, and publishing on the Hugging Face Hub."""
