"""What depends on what, and nothing else: each workflow reads like the sentence that describes it."""
