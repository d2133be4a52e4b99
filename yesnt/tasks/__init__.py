"""Tasks: the only place where kernels meet files. One file per stage: read, kernel, write, commit, receipt."""
