"""Named benchmarks: pictures with perfect ground truth on which any method is run and scored."""
