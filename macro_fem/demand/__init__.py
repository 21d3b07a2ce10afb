"""The law on demand: rings are asked where the curtain needs them, until the interval is as narrow as asked."""
