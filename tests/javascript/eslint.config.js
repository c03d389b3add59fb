import js from "@eslint/js";

export default [
  js.configs.recommended,
  {
    linterOptions: { reportUnusedDisableDirectives: "error" },
    rules: {
      "no-undef": "off", // `tsc` knows the names of browsers
      "no-unused-vars": ["error", { argsIgnorePattern: "^_" }],
      "prefer-const": "error",
      "no-var": "error",
      eqeqeq: "error",
      "no-implicit-globals": "error",
      "no-eval": "error",
      "no-new-func": "error",
      "no-script-url": "error",
      "array-callback-return": "error",
      "no-unmodified-loop-condition": "error",
      "no-self-compare": "error",
      "default-param-last": "error",
    },
  },
];
