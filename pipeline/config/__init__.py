"""The configuration: options, their checks, and the plain frozen objects made from them."""
