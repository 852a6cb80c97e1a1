/* Ranking and display of the site's search. Sphinx's searchtools.js parses the query and has the index of words; here
 * its results are ordered by how rare the found words are and by where a page has them, and shown with lines that
 * search_pages.js has, so that the search of a site opened from disk shows them, too. */
"use strict";

const WEIGHT = { title: 9, words: 8, heading: 4, lines: 2, text: 1 };
const BEGINNING = 0.5; // a page's word that only begins with the query's word counts this fraction
const WHOLE = 0.5; // fraction of a title's weight that depends on how much of the title was asked for
const TOGETHER = 0.5; // added for two words of the query that follow each other, a fraction of their weights
const SHOWN = 0.15; // results below this fraction of the best score are not shown
const AT_MOST = 25;
const LESS = { api: 0.8, changes: 0.3, configuration: 0.9, contributing: 0.5, evidence: 0.3 }; // pages that have every word

const stemmed = (() => {
  const stemmer = new Stemmer();
  const known = new Map();
  const stem = (word) => {
    if (!known.has(word)) known.set(word, stemmer.stemWord(word));
    return known.get(word);
  };
  return (text) => splitQuery(text.toLowerCase().replaceAll("_", " ")).filter((word) => !stopwords.has(word)).map(stem);
})();

/* The fields of all pages as lists of stems: {page: [{weight, stems, whole, section}]} */
const searchFields = () =>
  Object.entries(SEARCH_PAGES).map(([page, { title, words, description, sections }]) => [
    page,
    [
      { weight: WEIGHT.title, stems: stemmed(title), whole: true },
      ...words.split(",").map((word) => ({ weight: WEIGHT.words, stems: stemmed(word), whole: true })),
      { weight: WEIGHT.lines, stems: stemmed(description) },
      ...sections.flatMap(([heading, , lines], section) => [
        { weight: WEIGHT.heading, stems: stemmed(heading), whole: true, section },
        { weight: WEIGHT.lines, stems: stemmed(lines), section },
      ]),
    ],
  ]);

/* What a field gives for each word of the query, and for pairs of them */
const matchField = ({ weight, stems, whole }, asked) => {
  const has = asked.map(({ stem }) =>
    stems.includes(stem) ? 1 : stem.length > 3 && stems.some((other) => other.startsWith(stem)) ? BEGINNING : 0,
  );
  const found = has.filter(Boolean).length;
  const size = whole && stems.length ? weight * (1 - WHOLE + (WHOLE * found) / Math.max(stems.length, asked.length)) : weight;
  let pairs = 0;
  for (let i = 1; i < asked.length; i++)
    if (stems.some((stem, at) => stem === asked[i - 1].stem && stems[at + 1] === asked[i].stem))
      pairs += TOGETHER * size * (asked[i - 1].rarity + asked[i].rarity);
  return { each: has.map((fraction) => fraction * size), pairs };
};

const rankPages = (stems) => {
  const { terms, docnames } = Search._index;
  const inText = (stem) => {
    const found = Object.hasOwn(terms, stem) ? terms[stem] : [];
    return new Set((Array.isArray(found) ? found : [found]).map((number) => docnames[number]));
  };
  const pages = searchFields();
  const asked = stems.map((stem) => {
    const text = inText(stem);
    const anywhere = pages.filter(([page, fields]) => text.has(page) || fields.some(({ stems }) => stems.includes(stem)));
    return { stem, text, rarity: Math.log(1 + pages.length / (1 + anywhere.length)) };
  });
  const all = asked.reduce((sum, { rarity }) => sum + rarity, 0);
  const weighted = (each) => each.reduce((sum, value, i) => sum + value * asked[i].rarity, 0);
  const results = [];
  for (const [page, fields] of pages) {
    const best = asked.map(({ text }) => (text.has(page) ? WEIGHT.text : 0));
    let pairs = 0;
    let section = { score: 0 };
    let opening = 0;
    const bySection = new Map();
    for (const field of fields) {
      const match = matchField(field, asked);
      match.each.forEach((value, i) => (best[i] = Math.max(best[i], value)));
      pairs = Math.max(pairs, match.pairs);
      const score = weighted(match.each) + match.pairs;
      if (field.section === undefined) opening = Math.max(opening, score);
      else {
        const sum = (bySection.get(field.section) || 0) + score;
        bySection.set(field.section, sum);
        if (sum > section.score) section = { score: sum, number: field.section };
      }
    }
    const covered = asked.reduce((sum, { rarity }, i) => sum + (best[i] ? rarity : 0), 0) / all;
    const score = (covered ** 2 * (weighted(best) + pairs) * (LESS[page] || 1)) / all;
    if (!score) continue;
    const { title, description, sections } = SEARCH_PAGES[page];
    const [heading, anchor, lines] = section.score > opening ? sections[section.number] : [];
    results.push({
      page, score, title: heading ? `${title} > ${heading}` : title, anchor: heading ? `#${anchor}` : "",
      lines: (heading && lines) || description,
    });
  }
  return results;
};

/* Functions, classes and options whose name was asked for, from Sphinx's own search of objects */
const rankObjects = (objectTerms) =>
  [...objectTerms].filter((term) => term.length > 2).flatMap((term) =>
    Search.performObjectSearch(term, objectTerms).map(([page, title, anchor, lines, score]) => ({
      page, title, anchor, lines, score: score / 4,
    })),
  );

Search.query = (query) => {
  const [, , , highlighted, objectTerms] = Search._parseQuery(query);
  const stems = [...new Set(stemmed(query))];
  const results = [...rankPages(stems), ...rankObjects(objectTerms)].sort((a, b) => b.score - a.score);
  const shown = results.filter(({ score }) => score >= SHOWN * results[0].score).slice(0, AT_MOST);
  for (const { page, title, anchor, lines, score } of shown) {
    const item = Search.output.appendChild(document.createElement("li"));
    const link = item.appendChild(document.createElement("a"));
    link.href = page + DOCUMENTATION_OPTIONS.LINK_SUFFIX + anchor;
    link.dataset.score = score.toFixed(2);
    link.textContent = title;
    const context = item.appendChild(document.createElement("p"));
    context.classList.add("context");
    context.textContent = lines;
    if (SPHINX_HIGHLIGHT_ENABLED) highlighted.forEach((term) => _highlightText(item, term, "highlighted"));
  }
  _finishSearch(shown.length);
};
