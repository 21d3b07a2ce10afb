from macro_fem.cli import main

main(prog_name="python -m macro_fem")
