"""The true light of a virtual set, by radiosity in double precision."""
