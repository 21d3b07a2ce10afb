"""Error against run time: rings, contact search, laws, curtains, and the whole chain."""
