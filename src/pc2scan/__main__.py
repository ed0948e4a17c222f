"""``python -m pc2scan``."""

from .cli import main

if __name__ == "__main__":
    main()
