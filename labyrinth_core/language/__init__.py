"""The text language of labyrinths and other formats: parsing, dumping, drawing, syntax errors."""
