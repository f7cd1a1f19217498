"""Labyrinths that several tests look at."""

OPEN = """
labyrinth:
---------
|     E |
|   +   |
| S     |
---------
end
"""
SMALL_KEY_AND_DOOR = """
key_and_lock: True
labyrinth:
-------------
| K | D   E |
|   +   + - |
| S         |
-------------
end
"""
KEY_AND_DOOR = """
key_and_lock: True

labyrinth:
-------------
|   | D   E |
|   +   + - |
|           |
|   + - +   |
| S     | K |
-------------
end
"""
