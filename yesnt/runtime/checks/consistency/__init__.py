"""Do a shot's inputs agree? A few frames are measured; contradictions are reported with numbers before work starts."""
