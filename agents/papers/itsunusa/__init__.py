"""Herlambang, Subchan and Nurhadi on the AUV ITSUNUSA: an ensemble square-root filter in a dive."""
