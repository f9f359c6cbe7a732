"""Other people's interfaces: what was written for another simulator drives here unmodified."""
