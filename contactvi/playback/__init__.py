"""Pictures that move: the page and the live view, their shapes, lines, force arrows and animations."""
