"""Charts of computing time and force error for the numerical settings of a scene."""
