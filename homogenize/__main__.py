"""`python -m homogenize`: the command line of this package."""

from homogenize.cli import main

if __name__ == "__main__":
    main()
