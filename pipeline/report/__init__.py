"""The report on a folder of datasets, as one HTML file."""
