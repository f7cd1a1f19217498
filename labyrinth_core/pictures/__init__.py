"""Draw states as images, and encode them as vectors; both are exact to the last bit.

Many states are drawn together, from the parts of a picture that they share.
"""
