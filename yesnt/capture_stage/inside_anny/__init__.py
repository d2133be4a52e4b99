"""Scripts that run in the Python that has `anny`; they import nothing of yesnt."""
