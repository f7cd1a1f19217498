"""The text language of labyrinths and other formats: parsing, dumping and drawing.

Text from strangers is parsed with limits; errors name line and column.
"""
