"""The target: parts, their materials and the crinkles of foil, as the ray caster takes them."""
