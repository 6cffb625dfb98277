"""Studies of ships that maintainers rerun: Nomoto's model of those that come with the package."""
