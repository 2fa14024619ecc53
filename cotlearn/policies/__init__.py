"""Policies: observe a short history, sample a chunk of actions, act; training and comparison."""
