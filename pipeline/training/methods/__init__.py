"""The methods of learning; each is a module with `Settings` and `Method`."""
