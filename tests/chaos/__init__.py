"""What may go wrong in a run, done on purpose: the delivered bytes stay those of an undisturbed run."""
