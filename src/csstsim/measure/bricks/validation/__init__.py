"""Is a brick as its truth says: matches, numbers and gates, by brick and by exposure."""
