"""Analysis of many results: mass models, growth over time and comparison of treatments."""
