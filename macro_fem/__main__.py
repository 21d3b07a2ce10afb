"""python -m macro_fem."""

from macro_fem.cli import main

if __name__ == "__main__":
    main(prog_name="python -m macro_fem")
