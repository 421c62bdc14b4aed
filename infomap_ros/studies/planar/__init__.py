"""The planar experiments of Figs. 10 to 14 of Sujan and Dubowsky (2005), beside baselines.

doi:10.1177/0278364905051774
"""
