// Of three.js, whose types are larger than all that they would find in the two modules that use it.
declare const untyped: Three;
export = untyped;
