"""What a study varies, and which flights that makes."""
