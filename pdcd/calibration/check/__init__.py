"""Is the bench still as it was calibrated?"""
