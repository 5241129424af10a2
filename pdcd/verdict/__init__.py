"""What a photo is worth: figures of its pictures held against limits, and the sentences that say
so.
"""
