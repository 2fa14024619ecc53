"""The comparison of policies: one file for each (method, seed), and a summary of all of them."""
