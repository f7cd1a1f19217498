"""The methods of imitation learning; each is a module with `Settings` and `Method`."""
