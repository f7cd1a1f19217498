"""What stages need to declare their options: types, checks, one-line errors, shared options.

A stage is given a `Job`, plain frozen objects in which no option is invalid.
"""
