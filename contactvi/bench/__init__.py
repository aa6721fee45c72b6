"""`contactvi bench`: run time against error of a scene."""
