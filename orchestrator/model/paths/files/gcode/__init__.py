"""Programs in G-code: words, expressions and O words, codes and modes, offsets, motions, cycles."""
