-- What is derived from features of the state, as src/store/sqlite/stored_forms.rs writes it; null where there is nothing.
alter table environments add column derived text;
