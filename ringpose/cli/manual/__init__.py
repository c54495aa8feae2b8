"""The manual on machines without `man`: finding its pages, and their plain text."""
