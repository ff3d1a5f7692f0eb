-- What was counted. The words are those of src/domain. Every table is strict: in a plain one a sum past 2^63 - 1 silently becomes a float.

create table environments (
    -- never used twice, so that nothing which belongs to a deleted environment can be taken for a new one's
    id          integer primary key autoincrement,
    uid         text not null unique,
    -- null once it is removed, while its rows go in small steps
    name        text unique,
    schema      text not null,
    schema_hash blob not null check (length(schema_hash) = 32),
    rule        text not null
) strict;

-- Apart from the environment, whose schema may be long: this row is written with every commit.
create table totals (
    environment integer primary key references environments (id),
    transitions integer not null default 0 check (transitions >= 0),
    states      integer not null default 0 check (states >= 0),
    cells       integer not null default 0 check (cells >= states)
) strict;

create table segments (
    id          integer primary key autoincrement,
    environment integer not null references environments (id),
    -- '' for transitions without a segment
    label       text not null,
    unique (environment, label)
) strict;

create table states (
    id          integer primary key,
    environment integer not null references environments (id),
    -- the bins joined by dots: 3.0.7
    key         text not null,
    unique (environment, key)
) strict;

-- No reference to segments: removing one would then look for its cells through the whole table.
create table cells (
    state   integer not null references states (id),
    segment integer not null,
    joint   integer not null check (joint >= 0),
    n       integer not null check (n > 0),
    -- null once a transition came without the flag; a sum with null is null
    entries integer check (entries between 0 and n),
    primary key (state, segment, joint)
) strict, without rowid;

create table producers (
    id          integer primary key,
    environment integer not null references environments (id),
    name        text not null,
    -- the last one committed; 0 before the first
    sequence    integer not null check (sequence >= 0),
    unique (environment, name)
) strict;

-- The last 1,024 of each producer.
create table batches (
    producer integer not null references producers (id),
    sequence integer not null check (sequence > 0),
    digest   blob not null check (length(digest) = 32),
    receipt  text not null,
    primary key (producer, sequence)
) strict, without rowid;
