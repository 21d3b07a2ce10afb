"""How the commands of all packages read options, speak, end, and run for many inputs."""
