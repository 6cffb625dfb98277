"""Study files that come with vessel-gym: ``vessel-gym ablate quick``."""
