"""What no input may cause; its place is `support.bounded`."""

from support.bounded import watched

__all__ = ["watched"]
