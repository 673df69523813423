export const STLLoader: any;
