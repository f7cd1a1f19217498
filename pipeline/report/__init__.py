"""The report: a dataset as one HTML file."""
