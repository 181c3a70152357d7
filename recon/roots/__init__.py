"""From coverage to a tree of tubes: density, tracing, mending, ghosts, thick organs, and whose lateral is whose."""
