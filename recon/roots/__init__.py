"""From coverage to a tree of tubes and one solid: density, tracing, mending, ghosts, thick organs, and whose lateral is whose."""
