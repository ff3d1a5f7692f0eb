-- The networks that were trained, for what counts leave open.

-- The last version that was given. Kept apart, so that the highest can be deleted and is not used again.
create table model_versions (
    environment integer primary key references environments (id),
    last        integer not null check (last > 0)
) strict;

create table models (
    environment integer not null references environments (id),
    version     integer not null check (version > 0),
    -- positions of the agents
    ego         integer not null check (ego >= 0),
    other       integer not null check (other >= 0 and other <> ego),
    kind        text not null check (kind in ('direct', 'joint')),
    -- above those activated before it in the environment; null before it is activated and once it is rolled back.
    -- The version with the greatest of its pair is the active one.
    activated   integer check (activated > 0),
    card        text not null,
    primary key (environment, version),
    unique (environment, ego, other, activated)
) strict;

-- Apart from what changes: a switch must not write megabytes anew.
create table model_weights (
    environment integer not null,
    version     integer not null,
    weights     blob not null,
    primary key (environment, version),
    foreign key (environment, version) references models (environment, version) on delete cascade
) strict;
