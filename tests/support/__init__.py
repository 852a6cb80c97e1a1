"""What tests of several folders share: small cameras and campaigns, scenes, independent codes, processes."""
