"""What all packages share: errors, files, jobs, checked values, symmetric tensors, versions, the ends of commands."""
