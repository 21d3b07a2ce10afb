from homogenize.cli import main

main(prog_name="python -m homogenize")
