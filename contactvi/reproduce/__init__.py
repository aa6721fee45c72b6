"""`contactvi reproduce`: the paper's table and figure, measured."""
