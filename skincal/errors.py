"""The one exception for input that the user can mend."""


class InputError(Exception):
    """Input is at fault: the message says what was seen, what was expected and what to do. Exit code 2, no traceback."""
