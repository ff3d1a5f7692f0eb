-- What was fitted to the counts of all states: the prior of the evidence, the last one of each pair of agents.

create table fits (
    environment integer not null references environments (id),
    -- positions of the earlier and the later agent, then those held fixed: "0,1" or "0,2|1"
    pair        text not null,
    version     integer not null check (version > 0),
    -- how many transitions the environment had when it was made
    revision    integer not null check (revision >= 0),
    body        text not null,
    primary key (environment, pair)
) strict, without rowid;
