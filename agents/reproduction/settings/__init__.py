"""What each paper prints: settings, results and where they stand; and the settings that we had to assume."""
