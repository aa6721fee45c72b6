"""`python -m contactvi`: the command line."""

from contactvi.commands.entry import main

if __name__ == "__main__":
    main()
