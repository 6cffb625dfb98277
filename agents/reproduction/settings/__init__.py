"""What each paper prints: settings, results and where they stand; and what we had to assume."""
