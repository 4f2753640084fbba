"""The executables' command lines, which need nothing but Python: `--help` works anywhere."""
