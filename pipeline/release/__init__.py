"""The cards of datasets and policies, their side files, and publishing on the Hugging Face Hub.

A release is one commit and one tag, and `verify` compares it with the files here.
"""
