// Of three.js, whose types are larger than all that they would find in the one module that draws with it.
declare const untyped: any;
export = untyped;
