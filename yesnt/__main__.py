"""`python -m yesnt` is `yesnt`."""

from yesnt.cli import main

if __name__ == "__main__":
    main()
