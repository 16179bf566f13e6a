"""What is known without a proof: attested rates, long counts of hard queries, searches for a false negative."""
