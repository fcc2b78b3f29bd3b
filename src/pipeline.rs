//! run(Job): the steps in order; the only module that knows them all.
