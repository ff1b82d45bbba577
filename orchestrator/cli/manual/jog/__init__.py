"""`tutti axis jog`: axes jogged by keys of the terminal."""
