-- Whose producers are: the name of the key that first sent a batch of it which was counted. Null for those from before keys, and where nobody needs one:
-- they belong to the first key that speaks for them.
alter table producers add column owner text;
