-- Counts by sixteen neighbouring states a row, behind a journal: what was one row a cell. Both are as src/store/packed writes them.

-- What was counted and is in no row yet. An environment's entries are folded into its rows in order, and then go.
create table journal (
    -- rises with every commit; never used twice, for `folded` below says how far a fold goes
    id          integer primary key,
    environment integer not null references environments (id),
    cells       blob not null
) strict;

create table packed (
    -- the block of its environment times 2^44, and the number of the first of sixteen states divided by sixteen
    id    integer primary key,
    cells blob not null
) strict;

-- Whose rows are whose: each environment has a block of its own once something was counted in it. From 1 on.
alter table environments add column block integer check (block between 1 and 262143);
-- Where something was counted before, readers shall know it from the first moment on.
update environments set block = (select count(*) from totals where cells > 0 and environment <= environments.id)
where id in (select environment from totals where cells > 0);

-- The last entry of the journal that the last fold took or takes.
alter table totals add column folded integer not null default 0 check (folded >= 0);
-- The row at which that fold goes on; null once it has ended.
alter table totals add column fold_row integer check (fold_row >= 0);
-- 1 while the tables of cells and states have counts that are not packed yet.
alter table totals add column unmoved integer not null default 0 check (unmoved in (0, 1));
update totals set unmoved = 1 where cells > 0;

-- CRC-32 of what a row is and has, where that follows from nothing else that is kept: src/store/sqlite/checksums.rs. Null for rows of earlier builds.
alter table environments add column checksum integer check (checksum between 0 and 4294967295);
-- But for the sequence, which the batches lead up to.
alter table producers add column checksum integer check (checksum between 0 and 4294967295);
alter table fits add column checksum integer check (checksum between 0 and 4294967295);
alter table model_versions add column checksum integer check (checksum between 0 and 4294967295);
-- But for `activated`, which the index of it has too.
alter table models add column checksum integer check (checksum between 0 and 4294967295);
alter table model_weights add column checksum integer check (checksum between 0 and 4294967295);
alter table batches add column checksum integer check (checksum between 0 and 4294967295);
