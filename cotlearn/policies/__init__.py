"""Receding-horizon policies: sampling of action chunks, rollouts, training and comparison."""
