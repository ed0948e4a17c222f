"""``python -m pc2scan``."""

from pc2scan.cli import main

if __name__ == "__main__":
    main()
