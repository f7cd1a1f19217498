"""The stage `report`: all datasets of a folder, and the results on them, as one HTML file.

The page needs no server and loads nothing.
"""
