"""Photo sets with known truth, from brute-force integration of the reflection integral."""
