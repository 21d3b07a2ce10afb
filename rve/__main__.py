from rve.cli import main

main(prog_name="python -m rve")
