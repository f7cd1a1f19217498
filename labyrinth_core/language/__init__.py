"""The text language of labyrinths: parse, dump, its errors, edge lists, drawings."""
