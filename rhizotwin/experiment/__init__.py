"""What a laboratory asks of many results: masses from volumes, growth over days, treatments compared."""
