export const GLTFLoader: any;
