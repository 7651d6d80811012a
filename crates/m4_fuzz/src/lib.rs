//! Every reader of files, as the fuzzer and the replay of its findings call it.
