"""What readers of files make: steps, places and mistakes."""
